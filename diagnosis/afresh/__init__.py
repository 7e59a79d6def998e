"""Second looks: the likeliest explanations simulated again, at their fitted sizes, and held against the captures.

In the order in which :mod:`diagnosis.diagnose` asks for them:

* :mod:`~diagnosis.afresh.found_pose`: a camera's pose that was found in the pictures, found again;
* :mod:`~diagnosis.afresh.refinement`: the likeliest effects at their fitted sizes, in rounds;
* :mod:`~diagnosis.afresh.alike`: what presses the cloth to the panel in another way than the leading effect does;
* :mod:`~diagnosis.afresh.further`: the catalogue on trial, where much stays unexplained;
* :mod:`~diagnosis.afresh.between`: the leading effect at places that were not simulated beforehand;
* :mod:`~diagnosis.afresh.grip`: how magnets hold the cloth; if otherwise than stated, everything begins again;
* :mod:`~diagnosis.afresh.beside`: every second effect on the cloth, from states with the leading one on;
* :mod:`~diagnosis.afresh.together`: the likeliest pairs, both effects on;
* :mod:`~diagnosis.afresh.through`: an effect on the cloth at the size that it has beside one on camera or sensor;
* :mod:`~diagnosis.afresh.second`: a second effect on the cloth, sought by distance, where much stays unexplained;
* :mod:`~diagnosis.afresh.probing`: pins moved, weights and bends on trial, where the answer is open;
* :mod:`~diagnosis.afresh.moved_pin`: one pin elsewhere, which may do better than what is named.

What they share: :mod:`~diagnosis.afresh.fresh` simulates, :mod:`~diagnosis.afresh.outcomes` takes over what comes out,
:mod:`~diagnosis.afresh.by_distance` compares with captures, :mod:`~diagnosis.afresh.each_capture` and
:mod:`~diagnosis.afresh.side_by_side` go through captures and fabrics, :mod:`~diagnosis.afresh.once` weighs once.
"""
