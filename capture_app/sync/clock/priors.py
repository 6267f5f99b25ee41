"""What is taken for granted about clocks and links; docs/accuracy-measurements.md says what rests on it.

One sigma each, but for MAX_SKEW. Skews are dimensionless (1e-6 is 1 ppm), times in ns.
"""

MAX_SKEW = 1010e-6
"""The premise of the hard bound: 1000 ppm, in either clock's seconds. Crystals are within 100 ppm, and an NTP
daemon slews by 500 (adjtimex(2))."""
SKEW = 25e-6
"""Between two crystals; data sheets of those in computers and phones allow 20 to 50 ppm each."""
ODD_HOSTS = 3e-4
"""Likelihood of any other skew up to MAX_SKEW, as a share of that of none: virtual machines, slewed hosts."""
DRIFT = 0.025e-6 / 1e9
"""Change of a skew in a ns, before the samples show it: a crystal that warms up has up to 0.05 ppm/s."""
ASYMMETRY = 0.07
"""Half the difference of the two minimum delays, as a share of half the least round trip: no two-way message
can show it. The one quickest message of one WiFi link had 0.038 (Ansari et al. 2019, table III); chipsets are
slower one way in general (Mahmood, Exel and Sauter 2014). Set so that links drawn with 0.1 are covered; with
0.2, two in three are."""
STAMP_NS = 1_000.0
"""The asymmetry of two programs: one that was just woken up stamps late (real; on loopback and cables)."""
EXCESS = 0.7
"""How far the least delay measured lies above the minimum delay is the mean distance of the next ones to it,
give or take this share: chosen on 28 laws of delay that no experiment uses
(`benchmarks/clock/clock_laws.py`).
"""
