"""The directive `subcommand`: the reference page of a subcommand, generated from its `--help`."""

import inspect
from contextlib import contextmanager

import click
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from resgrid.cli import main


class Groups(click.HelpFormatter):
    """Collect the groups of options that `--help` prints."""

    def __init__(self):
        super().__init__()
        self.title, self.groups = "", {}

    @contextmanager
    def section(self, name):
        """Start a group of options."""
        self.title = name
        yield

    def write_dl(self, rows, **_):
        """Store the options of the current group."""
        self.groups[self.title] = rows


class SubcommandPage(SphinxDirective):
    """Description of a subcommand, its options in groups, and examples."""

    required_arguments = 1

    def run(self):
        """Return the nodes of the page."""
        name = self.arguments[0]
        context = click.Context(main, info_name="resgrid")
        command = main.get_command(context, name)
        context, groups = click.Context(command, info_name=f"resgrid {name}", parent=None), Groups()
        paragraphs = inspect.cleandoc(command.help).split("\n\n")
        contents = [nodes.paragraph(text=" ".join(paragraph.split())) for paragraph in paragraphs]
        contents.append(code(command.get_usage(context).removeprefix("Usage: ")))
        if getattr(command, "examples", ()):
            contents += [nodes.rubric(text="Examples"), code("\n".join(command.examples))]
        command.format_options(context, groups)
        for title, options in groups.groups.items():
            rows = nodes.definition_list()
            for option, meaning in options:
                term = nodes.term("", "", nodes.literal(text=option))
                rows += nodes.definition_list_item("", term, nodes.definition("", nodes.paragraph(text=meaning)))
            contents += [nodes.rubric(text=title), rows]
        return contents


def code(text):
    """Return a literal block without highlighting."""
    return nodes.literal_block(text, text, language="text")


def setup(app):
    """Register the directive."""
    app.add_directive("subcommand", SubcommandPage)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
