"""Folders and pages of results: numbers, tables and pictures together."""
