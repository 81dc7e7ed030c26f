"""The command line, a module each command; `cli.COMMANDS` names them."""
