"""`nermo calibrate`: the numbers that N does not print, fitted to half of its claims, judged by the other half."""
