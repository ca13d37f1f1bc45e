"""The paper: formation control of fixed-wing aircraft with strict speed constraints.

[HBH23] C. Heintz, S. C. C. Bailey, J. B. Hoagg, "Formation control for autonomous fixed-wing air
vehicles with strict speed constraints", Autonomous Robots, 2023. Pure functions over agents on the
leading axis; all they are told of another aircraft is what its messages said. `paper.md` maps
symbols and equations to the names used here.
"""
