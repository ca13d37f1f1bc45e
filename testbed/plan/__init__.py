"""From a scenario to a flight: files, gains and the graph of the formation, and the builders."""
