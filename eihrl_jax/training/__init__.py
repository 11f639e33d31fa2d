"""Training loops, run folders, checkpoints and progress."""
