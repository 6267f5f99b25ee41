"""Sessions in the forms that other programs open; one module a format, found by `registry`."""
