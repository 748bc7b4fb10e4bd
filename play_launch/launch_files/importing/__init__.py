"""Systems that were described by other programs, as configurations of ours."""
