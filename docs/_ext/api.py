"""The directive `api`: a table of public names, then each with its docstring and the examples that use it."""

import inspect
from importlib import import_module

from sphinx.util.docutils import SphinxDirective

import resgrid


class Api(SphinxDirective):
    """Names of `resgrid`, one a line."""

    has_content = True

    def run(self):
        """Write the directives that a person would."""
        names = [name.strip() for name in self.content if name.strip()]
        lines = [
            ".. currentmodule:: resgrid",
            "",
            ".. autosummary::",
            "   :nosignatures:",
            "",
            *(f"   {name}" for name in names),
            "",
        ]
        for name in names:
            lines += [*directive(name, getattr(resgrid, name)), "", f".. minigallery:: resgrid.{name}", ""]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


class Returned(SphinxDirective):
    """Types of what functions return, one a line, with their modules: nobody makes them by hand."""

    has_content = True

    def run(self):
        """Write the directives that a person would."""
        lines = []
        for path in (name.strip() for name in self.content if name.strip()):
            module, name = path.rsplit(".", 1)
            lines += [f".. currentmodule:: {module}", "", *directive(name, getattr(import_module(module), name)), ""]
        return self.parse_text_to_nodes("\n".join(lines))


def directive(name, value):
    """The autodoc directive for a name."""
    if inspect.ismodule(value):
        return [f".. automodule:: {value.__name__}", "   :members:", "   :no-index:"]
    if inspect.isclass(value) and issubclass(value, Exception):
        return [f".. autoexception:: {name}"]
    if inspect.isclass(value):
        return [f".. autoclass:: {name}", "   :members:", "   :undoc-members:"]
    return [f".. autofunction:: {name}"] if callable(value) else [f".. autodata:: {name}", "   :no-value:"]


def setup(app):
    """Register the directive."""
    app.add_directive("api", Api)
    app.add_directive("returned", Returned)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
