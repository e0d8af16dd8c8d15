"""The two presets. `paper` is the defaults of every config; all departures of `fast` are listed here."""
