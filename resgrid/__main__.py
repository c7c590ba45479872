"""``python -m resgrid``: the command ``resgrid`` of this Python."""

from resgrid.cli import main

if __name__ == "__main__":
    main()
