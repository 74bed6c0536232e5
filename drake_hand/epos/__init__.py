"""EPOS motor drives over CANopen: master, simulated drives, mirror. Imports no Drake."""
