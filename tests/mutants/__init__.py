"""Small faults in the files that keep the robot safe, one at a time: a test has to fail for each (`make mutants`).

cosmic-ray makes them (operators.py). mutmut, the other tool that is kept up, mutates functions only: no constant of a
module, no field of a class, no table, no property, and it takes no operators of one's own. cosmic-ray has operators by
name and an interface for more; what parso, its parser, does not know is `match`, so that patterns stay as they are.

Only its operators are used. Measured with spi/guard.py: `cosmic-ray exec` takes 1.9 s of processor time for each of 145
mutants, since it does not see which mean the same; here it is 0.9 s for each of 60. It also writes each mutant into the
working tree: a robot's program with a fault in it where somebody ends the run. Here a process is forked for each, with
the libraries loaded, and no file is written (judging.py).

judges.py: which tests judge which file. by_hand.py: what no operator can make. Scores are judged by one
floor (__main__.py). A mutant that no test need notice is accepted by a comment with its operator's
name and the reason, at its line or at the first line of its function or class:
`# mutants accepted (Step, Gt_GtE): equal times`. All are judged all the same; what survives there does not count.
"""
