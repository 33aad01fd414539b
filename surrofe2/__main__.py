"""The start of the command line, by `surrofe2` or `python -m surrofe2`."""

import traceback
from importlib import import_module

from surrofe2.base.interruption import watch
from surrofe2.base.launcher import end_job, world_size


def main() -> None:
    """Run the command line; it can be interrupted from the first moment."""
    watch()
    try:
        cli = import_module("surrofe2.cli")
    except Exception:
        if world_size() > 1:  # other ranks would wait for this one
            traceback.print_exc()
            end_job()
        raise
    cli.main()


if __name__ == "__main__":
    main()
