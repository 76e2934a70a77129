"""Front and back differ in stiffness more than the parameters say.

    beta_front (1 + a) (1 + l),    beta_back (1 - a) (1 - l)
    alpha_front (1 + l),           alpha_back (1 - l)

Source: wires that do not lie alike in the matrix (the paper finds its two sides to differ); l: one
side nearer to the middle, where the same strain bends more and meets more stiffness, eq. (16).
`Boundary.of` applies it."""
