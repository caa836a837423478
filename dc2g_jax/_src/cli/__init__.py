"""The command line: the commands, and the code that they share."""
