"""From a scenario to a flight: files, gains and the graph of the formation, and the builders.

`world.build` makes the world of a scenario, which `flight.world` describes and `flight.loop` flies.
`user_code` imports laws and functions of users.
"""
