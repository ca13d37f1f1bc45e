"""The flight: records, stages and the loop that runs them."""
