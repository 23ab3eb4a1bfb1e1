"""One module per subcommand of ``mvuav``."""
