"""``python -m resgrid.cli.warm``: compile every loop beforehand, on all cores."""

from __future__ import annotations

import click

from resgrid.cli.terminal import detail, say, stage


@click.command(name="python -m resgrid.cli.warm")
@click.option("-j", "--jobs", type=click.IntRange(1), help="Processes; as many as there are cores by default.")
def command(jobs: int | None) -> None:
    """Compile every loop on all cores, so that no first solution waits for it.

    What is compiled already is loaded: a second call takes seconds.
    """
    from resgrid.cli.kernel_warmup import CASES, compile_loops

    say(f"compiling the loops, once after an installation: {len(CASES)} small jobs, a minute or two on two cores")
    with stage("compile the loops", steps=len(CASES)) as progress:
        for name in compile_loops(jobs):
            progress.advance()
            detail(f"compiled: {name}")


if __name__ == "__main__":
    command()
