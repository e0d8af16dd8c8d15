"""What everything stands on: settings, errors, files, locks, and ending in order."""
