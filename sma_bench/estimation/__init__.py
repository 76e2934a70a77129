"""The one estimation engine, used by all experiments and by the diagnosis.

    y_s = O_s[ F(V(z); theta) ] + N_s z + e_s

theta: parameters under their priors (unknowns.py); V: voltages (voltage.py); O_s: means of a
record's signals over bins (observation.py); z ~ N(0, 1): nuisances (nuisances.py); e_s: noise
(noise_model.py). One residual (residual.py), one solver (solver.py), one result (result.py)."""
