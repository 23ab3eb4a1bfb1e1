"""What ``mvuav bench`` measures."""
