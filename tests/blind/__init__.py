"""The project's own blind check of the diagnosis: recordings with a withheld effect, answers, and their score.

`generator` and what it stands on (`plans`, `motion`, `device`, `effects`, `signatures`) share no code with `planrunner`: attitudes are
direction cosine matrices stepped in time, rates and accelerations their differences. `commitment` seals the labels before anything is
answered, `campaign` makes and answers, `scoring` compares; `oracle` knows the generator, `baselines` are what a user would reach for.
"""
