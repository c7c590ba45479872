"""``resgrid completion``: print a shell script that completes subcommands, options, their values and files."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from resgrid.cli.options import Subcommand

INSTALLATION = {
    "bash": 'eval "$(resgrid completion bash)"  in ~/.bashrc',
    "zsh": 'eval "$(resgrid completion zsh)"  in ~/.zshrc',
    "fish": "resgrid completion fish | source  in ~/.config/fish/config.fish",
}


@click.command(
    "completion",
    cls=Subcommand,
    examples=tuple(line.split("  in ")[0] for line in INSTALLATION.values()),
)
@click.argument("shell", type=click.Choice(tuple(INSTALLATION)))
@click.pass_context
def command(context: click.Context, shell: str) -> int:
    """Print the script with which SHELL completes subcommands, options, their values and files.

    Add the line of the example to ~/.bashrc, ~/.zshrc or ~/.config/fish/config.fish.
    """
    form = get_completion_class(shell)
    if form is None:
        raise click.UsageError(f"click has no completion for {shell}; use {', '.join(INSTALLATION)}")
    click.echo(form(context.find_root().command, {}, "resgrid", "_RESGRID_COMPLETE").source())
    return 0
