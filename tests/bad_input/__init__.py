"""Files that are damaged or mean harm, made by a generator; see `corpus`."""
