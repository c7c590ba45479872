"""``python -m resgrid.cli.warm``: compile all kernels before they are needed, in one process per core."""

from __future__ import annotations

import click

from resgrid.cli.terminal import detail, say, stage


@click.command(name="python -m resgrid.cli.warm")
@click.option("-j", "--jobs", type=click.IntRange(1), help="Processes; as many as there are cores by default.")
def command(jobs: int | None) -> None:
    """Compile all kernels on all cores, so that no solution waits for their compilation.

    Cached kernels are not compiled again: a second call takes seconds.
    """
    from resgrid.cli.kernel_warmup import CASES, compile_kernels

    say(f"compiling the kernels, once after an installation: {len(CASES)} small jobs, a minute or two on two cores")
    with stage("compile the kernels", steps=len(CASES)) as progress:
        for name in compile_kernels(jobs):
            progress.advance()
            detail(f"compiled: {name}")


if __name__ == "__main__":
    command()
