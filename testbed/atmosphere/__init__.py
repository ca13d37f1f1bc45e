"""The air: mean wind, turbulence, gusts and wakes, and the wind at each aircraft."""
