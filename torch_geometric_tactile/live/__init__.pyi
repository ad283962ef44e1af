from .source import Source, SourceEnded

__all__ = [
    "Source",
    "SourceEnded",
]
