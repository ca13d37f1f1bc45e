"""The air: mean wind, turbulence, gusts and wakes. Knows no aircraft but by where it is."""
