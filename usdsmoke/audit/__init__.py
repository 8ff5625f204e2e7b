"""What a result says about how it was made: read, verified, made again, exported as PROV."""
