"""VDB files in, dense arrays out, and back; OpenVDB itself is met in a child process only."""
