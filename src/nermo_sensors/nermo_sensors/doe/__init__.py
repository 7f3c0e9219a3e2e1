"""Design of experiments for the piezoresistive cell (C 4.2): which parameters matter, is a given foot feasible."""
