"""Front and back differ in stiffness more than the parameters say.

    beta_front (1 + a) (1 + l),    beta_back (1 - a) (1 - l)
    alpha_front (1 + l),           alpha_back (1 - l)

a: the wires of the two sides are embedded differently (the paper's two sides differ). l: one side's
wires lie nearer to the middle, where the same strain bends more against more stiffness (eq. 16).
Source: assumed. `Boundary.of` applies it."""
