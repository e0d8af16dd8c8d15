"""What everything stands on: settings, files, locks, and ending in order."""
