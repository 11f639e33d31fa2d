"""Command lines; each parses its options, makes one library call and writes the result."""
