(define (problem one-ball) (:domain untyped)
  (:objects rooma roomb ball1 left)
  (:init (room rooma) (room roomb) (ball ball1) (gripper left) (at-robby rooma) (free left) (at ball1 rooma))
  (:goal (at ball1 roomb)))
