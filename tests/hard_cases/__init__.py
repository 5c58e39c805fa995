"""Hard cases: where the numbers could break, each with a measured bound.

`topics.TOPICS` lists them; pytest holds each case to its bound, and
`experiments/hard_cases.py` prints the same cases as a table.
"""
