"""Many tasks at once: a grid of them planned, proved and replayed on all cores or a cluster, and a data set of it."""
