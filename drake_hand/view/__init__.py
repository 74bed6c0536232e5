"""Plans in the browser and as figures."""
