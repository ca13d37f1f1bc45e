"""What a scenario means for its aircraft, worked out once before anything is built."""
