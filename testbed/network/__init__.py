"""Messages between aircraft: delay, loss, rate, encoding, statistics."""
