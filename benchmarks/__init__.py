"""How accurate and how fast surrofe2 is, as a user gets it: `python -m benchmarks`.

`docs/measured.json` holds every measured figure that README and documentation quote. Each topic
below is a module with `run(bench)`, which records its figures:

    runs      the shipped bars by whole commands: full and cached FE², data and training included
    large     larger bars: the first run with everything counted; tables
    solve     one RVE, one lookup: seconds of the calls that runs are made of
    tissue    FE² against the full tissue
    start     help, first and second start, memory
    trust     every accepted answer of the cache audited
    ranks     MPI ranks against threads (on request)
    suites    the quick, slow and nightly tests (on request)

`measured` says what a figure is, `pages` writes figures into README and documentation, `timing` how
times are taken, `commands` runs surrofe2. What is compared is timed in turns, after compilation.
"""
