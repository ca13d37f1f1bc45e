"""Formation control of fixed-wing aircraft with strict speed constraints.

[HBH23] C. Heintz, S. C. C. Bailey, J. B. Hoagg, "Formation control for autonomous fixed-wing air
vehicles with strict speed constraints", Autonomous Robots, 2023. The kernels compute for one
follower, whose only data of other aircraft are the messages that it has received. `paper.md` maps
the paper's symbols and equations to the names used here.
"""
