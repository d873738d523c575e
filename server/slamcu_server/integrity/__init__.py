"""Whether what is stored hangs together, and whether two databases hold the same."""
