"""surrofe2."""
