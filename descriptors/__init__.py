"""An intersection as numbers: wall contours (PWCV, CWC), their similarity, and Scan Context as the baseline."""
