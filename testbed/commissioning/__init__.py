"""An aircraft from elsewhere: import, first gains, flight tests, variants, fits to recordings."""
