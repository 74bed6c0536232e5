"""Task files, reach tables, search, transit: from what is asked to a path."""
