"""Operators on fields: interpolation, back-traces, transport, displacement, sparse maps."""
