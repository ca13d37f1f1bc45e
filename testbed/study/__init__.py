"""Studies of many flights: the same page over several seeds, held against a table kept before.

A study builds pages, flies them apart from one another, and looks at nothing but their metrics. It
knows the scenario, the runner and the metrics document; no other room knows a study.
"""
