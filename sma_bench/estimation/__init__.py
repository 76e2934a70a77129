"""The one engine of every estimate.

    y_s = O_s[ F(V(z); theta) ] + N_s z + e_s

theta under their priors (unknowns.py), the voltages V (voltage.py), a record's signals as means
over bins O_s (observation.py), what else may be off z ~ N(0, 1) (nuisances.py), noise e_s
(noise_model.py); one residual (residual.py), one solver (solver.py), one result (result.py)."""
