"""Many tasks at once: a grid planned, certified and replayed on all cores or a cluster, and exported as a data set."""
