"""Linear models of aircraft and formations: modes, margins, frequency responses, string gains."""
