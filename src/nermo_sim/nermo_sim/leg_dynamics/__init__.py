"""The dynamics of the pantograph leg (C chapter 2): closed loops, minimal coordinates, mass-less segments."""
