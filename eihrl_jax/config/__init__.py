"""Configurations: frozen dataclasses that check their own values."""
