"""The ``mvuav`` command; every subcommand has a module of its own."""
