"""Recordings of real flights: their columns, CSV from elsewhere, and formations of several."""
