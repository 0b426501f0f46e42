"""What a command line may not say: each wrong line is refused in a sentence that helps."""

from __future__ import annotations

import shlex

import pytest

#: A line for each wrong command line: words of the answer, and the line.
TABLE = """
did you mean 'solve'                       | slove pendulum
did you mean 'pendulum'                    | solve pendulm newmark
did you mean 'newmark'                     | solve pendulum newmrk
did you mean 'beta'                        | solve pendulum newmark[betta=1]
has no option 'mass'                       | solve pendulum newmark --set mass=1
in 'pendulum[m=2]' and again by itself     | solve pendulum[m=2] newmark --set m=1
not a finite number                        | solve pendulum newmark --set m=nan
not of the form name=value                 | solve pendulum newmark --set m
outside                                    | solve pendulum newmark --set m=-1
give a positive number                     | solve pendulum newmark --step 0
give a positive number                     | solve pendulum newmark --step nan
larger than the interval                   | solve pendulum newmark --step 7
give a larger one                          | solve pendulum newmark --step 1e-320
does not lie after the start               | solve pendulum newmark --t-end 0.1
does not lie after the start               | solve pendulum newmark --t-end nan
takes fixed steps                          | solve pendulum newmark --rtol 1e-3
takes steps of its own                     | solve pendulum ida --step 0.1
rtol=0 is not allowed                      | solve pendulum ida --rtol 0
not a list of numbers                      | solve pendulum newmark --pattern 0.3,x
sum to 1                                   | solve pendulum newmark --pattern 0.3,0.3
constraints act like infinite frequencies  | solve pendulum newmark[beta=0]
not a Python file, nor a folder with one   | solve pendulum newmark --plugins no_such.py
from 'Z'; known: X, X.v, Y, Y.v            | solve pendulum[start.Z=1] newmark
no start near its own with X=5             | solve pendulum[start.X=5] newmark
start.X=nan is not a finite number         | solve pendulum[start.X=nan] newmark
start.X=one is not a float                 | solve pendulum[start.X=one] newmark
sample_time=0                              | solve sampled_pd[sample_time=0] bdf2
sampling=often is not allowed              | solve sampled_pd[sampling=often] bdf2
only constant steps                        | solve sampled_pd[sampling=interpolate] ida

'0.1,,0.05,0.025' is not a list of numbers | order spring_mass newmark --steps 0.1,,0.05,0.025
'm' is given twice                         | order spring_mass newmark --set m=1 --set ' m =2'
not of the form name=value                 | order spring_mass newmark --set 'm= '
The budget is nan; give a time in s above  | order spring_mass newmark --budget nan
at least three                             | order pendulum newmark --steps 0.1,0.05
Missing argument 'INTEGRATOR...'           | order pendulum
chooses its own steps, over which no order | order pendulum newmark ida

did you mean 'quick'                       | run quik
cannot be read                             | run none.toml
no scene 'nothing'                         | run -p nothing
did you mean 'wbz'                         | run --mine wbzz
no integrator 'nothing'                    | run -i nothing
no stepbench results                       | report nowhere
--open and --csv do not go together        | report --csv --open
--csv and --json do not go together        | report --csv --json
say --csv or --json                        | report -o a.svg
The path of a plugin is empty              | list --plugins ''
The path of a plugin is empty              | list --plugins ' '
pages of scenes alone                      | list newmark --draw
leave out --json                           | list pendulum --draw --json
--out goes with --draw                     | list --out pages

did you mean 'pendulum'                    | show pendulm
does not lie after the start               | show pendulum --t-end 0.1
x.pdf is not a picture; give a name that ends in .svg | show pendulum -o x.pdf
give a name that ends in .html             | show pendulum --animate -o x.svg
there is no folder                         | show pendulum -o no/such/folder/x.svg

Nothing is named; give names or Python files, or --all. | check
did you mean 'pendulum'?                   | check pendulun
has no option 'bet'; did you mean 'beta'?  | check newmark[bet=1]
is not a Python file, nor a folder         | check no_such_file.py

did you mean 'undamped_index3'? (known: | atlas undamped_index

in small letters, digits and '_'           | new integrator 'My Method'
such as my_method                          | new problem 3d
The name 'pendulum' is taken by            | new integrator pendulum
scene.txt is not the name of a Python file | new problem scene --out scene.txt
no folder 'nowhere'; make it first.        | new problem scene --out nowhere/scene.py
mine.py is there already                   | new problem mine
--from takes a model                       | new integrator my_method --from one.py
there is no file 'robot.xml'.              | new problem my_robot --from robot.xml
--set belongs to a model                   | new problem my_robot --set contacts=left_out

did you mean 'pendulum'                    | recommend pendulun
is no demand                               | recommend pendulum --error a
budget                                     | recommend pendulum --budget 0
friction states no energy                  | recommend friction --error energy:1
spring_mass names no points                | recommend spring_mass ida --error points:1
ranked by one error, and 2 are asked for   | recommend pendulum --rule iftomm
or name integrators                        | recommend pendulum --error q:1 --error a:1
No integrator takes heavy_top_so3          | recommend heavy_top_so3 rodas5p
There is no scene 'quick'                  | recommend quick --t-end 1
the scenes one, two; name one              | recommend two.py
defines no MechatronicSystem               | recommend none.py

named twice                                | drift oscillator newmark newmark
not allowed                                | drift oscillator newmark --step -1
end time                                   | drift oscillator newmark --step 1e306
range                                      | drift oscillator newmark --steps 1

chooses its own steps; an amplification matrix needs constant steps | stability ida
give positive fractions of the macro step  | stability newmark --pattern 0.3,0.3
omega h = -2 is not allowed                | stability newmark --at 1,-2
zeta=-1                                    | stability newmark --zeta -1
--zeta damps the oscillator                | stability newmark --zeta 0.1 --system loop
is named twice                             | stability newmark newmark[beta=0.25]
does not take joined                       | stability newmark[beta=0] --system joined
cannot be found by running it              | stability kvaerno5 --system joined
Missing argument                           | stability

is not in the range x>0                    | realtime pendulum newmark --rate 0
from 2 to 1000000 steps                    | realtime pendulum newmark --rate 1e400
not a valid float range                    | realtime pendulum newmark --rate 1kHz
not in the range                           | realtime pendulum newmark --rate 1e3 --iterations 0
at most 1 s, the interval of pendulum      | realtime pendulum newmark --rate 1e3 --duration 1e3
from 2 to 1000000 steps                    | realtime pendulum newmark --rate 1e9
--rate                                     | realtime pendulum newmark
1000 Hz over 0.001 s is not allowed        | realtime pendulum newmark --rate 1e3 --duration 1e-3
chooses its own steps                      | realtime pendulum ida --rate 100
called alone                               | realtime pendulum generalized_alpha_adaptive --rate 100
library holds                              | realtime pendulum dopri8 --rate 100
does not take pendulum                     | realtime pendulum stormer_verlet --rate 100
jump at samples or events                  | realtime sampled_pd[sampling=ignore] newmark --rate 100
which the method does not handle           | realtime heavy_top_se3 bdf2 --rate 100
give newton=full, or no limit | realtime pendulum newmark[newton=modified] --rate 100 --iterations 2
"""
#: Plugin files with a scene, with two of them, with none, and with a trace of being imported; and
#: what else is there.
FILES = {
    "innocent.py": "open('imported', 'w').close()\n",
    "one.py": "from problems.scenes.pendulums import Pendulum\nclass One(Pendulum):\n    'One.'\n",
    "none.py": '"""Nothing."""\n',
    "mine.py": "precious",
}
FILES["two.py"] = f"{FILES['one.py']}class Two(Pendulum):\n    'Two.'\n"


@pytest.mark.usefixtures("without_processes")
def test_a_wrong_line_is_refused_in_a_sentence_and_nothing_is_written(
    refused, tmp_path, monkeypatch
):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    for case in filter(None, TABLE.splitlines()):
        words, line = case.split("|")
        assert words.strip() in refused(*shlex.split(line)), line
    there = [path for path in tmp_path.iterdir() if path.name != "__pycache__"]
    assert {path.name: path.read_text() for path in there} == FILES
