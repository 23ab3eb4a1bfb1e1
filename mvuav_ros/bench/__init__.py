"""Cases of ``mvuav bench``: our code beside the bare calls that any implementation needs."""
