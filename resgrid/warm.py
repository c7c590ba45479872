"""``python -m resgrid.warm``: compile every loop beforehand, on all cores."""

from __future__ import annotations

from resgrid.cli.warm import command

if __name__ == "__main__":
    command()
