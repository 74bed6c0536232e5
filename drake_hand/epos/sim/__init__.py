"""The simulated hand: EPOS drives on a CAN bus, in a process of their own."""
