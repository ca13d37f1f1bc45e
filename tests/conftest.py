"""Has pytest find what tests of every folder share: the modules beside this file."""
