"""What the README's figures are measured with, one module per subject."""
