"""Golden tables: numbers of flights that must not change, and comparisons of runs."""
