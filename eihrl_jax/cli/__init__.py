"""The command lines: a shell around each, and the table of all of them."""
