"""Statistics of whole recordings that images alone show: sides, trigger, rows, lenses, torn images."""
