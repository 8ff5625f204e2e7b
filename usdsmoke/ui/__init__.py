"""What people use: the command line and usdview's menu."""
