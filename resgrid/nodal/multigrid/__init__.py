"""Conjugate gradients preconditioned by multigrid: the algorithm on one page.

`solver.MultigridFactor` solves ``A x = b`` for the nodal matrix of a grid or a netlist, in this order:
1. *Before*: corridors, chains and trees have been eliminated (`resgrid.nodal.reduction`).
2. *Hierarchy* (`hierarchy.build_hierarchy`, `levels`).  A level is a graph of conductances.  The next one has a
   node for every aggregate: on grids the connected parts of blocks of two cells a side, cut where a conductance is
   weak beside the strongest at either end, so that no aggregate joins across a wall; axes that conduct badly are
   left for later. Middle to middle, two blocks are joined through half of either one's own resistance in series
   with what lies between (plain aggregation would make long ways too easy).  In other netlists aggregates
   of four are grown node by node along the strongest conductances (`clusters`), and the rows of a level are laid out
   by colour and length (`ordering`).  Levels that have become corridors one node wide shrink by exact elimination.
3. *First level* (`checkerboard`, `checkerboard_kernels`).  A grid has two colours: red cells are eliminated
   exactly, and everything happens on the Schur complement of the black ones, over conductances in single precision,
   one face of all cells after the other.
4. *Iteration* (`iteration.iterate`).  Flexible conjugate gradients (Notay 2000) in bursts of at most five digits:
   after each the residual is formed anew from the true conductances, differences first, and the search directions
   go on.  It ends at ``rtol |b|``, or where rounding, ``eps |A| |x|``, forbids more.
5. *Cycle* (`kernels.cycle`).  Gauss-Seidel, red before black on the way down and black before red on the way up, so
   that the preconditioner is symmetric; K-cycles (Notay & Vassilevski 2008) on the coarse levels: one or two steps
   of conjugate gradients, each preconditioned by the level below.  The coarsest matrix is inverted.
6. *Refinement* (`resgrid.nodal.refine`) makes a normwise answer right entry by entry: residuals in scaled double-
   double, every pass a solution to nine digits of what is largest, until the potential has fallen as far as it
   falls.

References
----------
Notay, Flexible conjugate gradients, SIAM J. Sci. Comput. 22 (2000) 1444.
Notay & Vassilevski, Recursive Krylov-based multigrid cycles, Numer. Linear Algebra Appl. 15 (2008) 473.
Notay, An aggregation-based algebraic multigrid method, Electron. Trans. Numer. Anal. 37 (2010) 123.
Braess, Towards algebraic multigrid for elliptic problems of second order, Computing 55 (1995) 379 (why plain aggregates
need their conductances corrected).
"""
