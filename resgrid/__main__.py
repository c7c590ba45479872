"""``python -m resgrid``: run the command ``resgrid`` with this Python interpreter."""

from resgrid.cli import main

if __name__ == "__main__":
    main()
