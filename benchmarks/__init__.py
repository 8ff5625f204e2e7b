"""What usdsmoke is measured by; run each part as ``python -m benchmarks.NAME`` from the root."""
