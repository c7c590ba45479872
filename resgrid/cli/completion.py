"""``resgrid completion``: what lets a shell complete verbs, options, their values and files."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from resgrid.cli.options import Verb

HOW = {
    "bash": 'eval "$(resgrid completion bash)"  in ~/.bashrc',
    "zsh": 'eval "$(resgrid completion zsh)"  in ~/.zshrc',
    "fish": "resgrid completion fish | source  in ~/.config/fish/config.fish",
}


@click.command(
    "completion",
    cls=Verb,
    examples=tuple(how.split("  in ")[0] for how in HOW.values()),
)
@click.argument("shell", type=click.Choice(tuple(HOW)))
@click.pass_context
def command(context: click.Context, shell: str) -> int:
    """Print the script that lets SHELL complete verbs, options, their values and files.

    Put the line of the example into ~/.bashrc, ~/.zshrc or ~/.config/fish/config.fish.
    """
    form = get_completion_class(shell)
    if form is None:
        raise click.UsageError(f"click does not complete in {shell}")
    click.echo(form(context.find_root().command, {}, "resgrid", "_RESGRID_COMPLETE").source())
    return 0
