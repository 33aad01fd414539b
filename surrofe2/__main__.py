"""The start of the command line, by `surrofe2` or `python -m surrofe2`."""

from importlib import import_module

from surrofe2.base.interruption import watch


def main() -> None:
    """Run the command line; it can be interrupted from the first moment."""
    watch()
    import_module("surrofe2.cli").main()


if __name__ == "__main__":
    main()
