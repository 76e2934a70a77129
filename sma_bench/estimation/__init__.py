"""The one engine of every estimate.

    y_s = O_s[ F(V(z); theta) ] + N_s z + e_s

theta under their priors (unknowns.py), the voltages V (voltage.py), a record's signals as means
over bins O_s (observation.py), what may be off beside the model z ~ N(0, 1) (nuisances.py), noise
e_s white and drifting (noise_model.py); one flat residual and its derivatives (residual.py), one
solver (solver.py), one result (result.py).
"""
