"""Submodels, object surfaces, contact kinematics and contact forces."""
