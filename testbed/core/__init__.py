"""Records, frames, random streams, compiling, files and errors, shared by all packages."""
