"""``mvuav demo``: the sample bags through real nodes in processes of their own."""
