"""Damage MAVLink frames at random, in tests of what receives them."""


def broken(frame, rng):
    """Return a cut or changed frame, or noise in its place; never the frame itself."""
    way = rng.randrange(6)
    if way == 0:
        return rng.randbytes(rng.randrange(1, 400))
    if way == 1:
        return frame[: rng.randrange(1, len(frame))]
    if way == 2:
        return bytes(rng.choice(b"\xfd\xfe\x00\x01\xff") for _ in range(rng.randrange(1, 80)))
    if way == 3:
        at = rng.randrange(1, len(frame))
        return frame[:at] + frame[at + 1 :]
    changed = bytearray(frame)
    # a bit in any byte; the checksum also covers the system id
    for _ in range(1 if way == 4 else rng.randrange(2, 12)):
        at = rng.randrange(len(changed))
        changed[at] ^= 1 << rng.randrange(8)
    return b"\xfd" if bytes(changed) == frame else bytes(changed)
