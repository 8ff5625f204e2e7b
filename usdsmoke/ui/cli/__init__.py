"""The command line: arguments, commands, text output."""
