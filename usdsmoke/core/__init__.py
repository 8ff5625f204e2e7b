"""The stylization core: torch and numpy only; it knows neither USD nor VDB."""

__all__: list[str] = []
