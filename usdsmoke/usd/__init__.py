"""USD stages in and out: what a stage holds, what it requests, the look layer, the rules."""
