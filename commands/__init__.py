"""One module per command of the command line: arguments, files, exit codes, progress, and no mathematics."""
