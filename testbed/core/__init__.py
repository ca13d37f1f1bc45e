"""Records, frames, random streams and other modules that all packages share."""
