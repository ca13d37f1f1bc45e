"""A benchmark of formation laws: frozen tasks, entries, numbers, ranks."""
