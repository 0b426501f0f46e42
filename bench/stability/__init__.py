"""The stability laboratory: what a step does to linear systems, and where it starts to amplify."""
