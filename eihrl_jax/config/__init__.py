"""Options of every command as frozen dataclasses, their presets and limits, and the JSON codec."""
