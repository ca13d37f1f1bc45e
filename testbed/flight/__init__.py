"""The flight: records, stages and the loop that runs them.

`world` has the parts of a flight, `loop` runs its stages at their ticks, and `tick_loop` does so in
compiled code.
"""
