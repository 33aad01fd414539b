"""Runs of other codes, as scripts for the Python they are installed in.

Each reads a tissue from the JSON file named first, takes the number of steps named second, and
prints JSON: "version" and "seconds" of the steps alone. They import nothing of surrofe2.
"""
