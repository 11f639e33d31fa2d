"""Files: regular ones of bounded size are read, new ones are written whole."""
