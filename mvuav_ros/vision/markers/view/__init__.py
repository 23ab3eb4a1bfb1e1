"""How a rig is seen: fitted to named lights, and followed."""
