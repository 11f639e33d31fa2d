"""Pictures: perspective views, animations, heatmaps, curves.

Nothing else imports matplotlib or PIL, but for the pages of `reporting`.
"""
