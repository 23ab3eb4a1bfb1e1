"""``tuning_panel``: the thesis's GUI for running nodes, as a page in the browser.

The modules of this package talk to ROS, files and processes; ``page`` shows them.
"""
