"""One run: its folder, its windows, its written frames, its error budget."""
