"""One receiver's stream of raw measurements: its epochs solved, judged and made ready for a filter.

:mod:`run` is the kernel that takes epochs one after the other, :mod:`epochs` the columns that it
fills, :mod:`receiver` what stays between runs, :mod:`news` what there is to say of them.
"""
