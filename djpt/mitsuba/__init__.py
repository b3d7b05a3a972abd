"""Names that exist for the sake of scripts written for Mitsuba 3.

The renderer doesn't need them: nothing outside of this package imports from it, and `import djpt` reads only its table
of names (`djpt.mitsuba.names`). One file per family; a name is imported when a script first uses it.
"""
