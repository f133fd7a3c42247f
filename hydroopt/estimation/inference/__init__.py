"""What all estimators share: constraints, priors, least squares, SDP, NLP, posterior, identifiability."""
