"""Runways found by themselves: searched, weighed, and followed as several that may be the one."""
