"""What a formation bears, found before a flight: margins, largest values, faults, a verdict."""
