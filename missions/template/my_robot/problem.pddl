#if pddl
; CHANGE: your objects, what holds at the start, and the goal.
(define (problem explore_the_cave)
  (:domain my_robot)
  (:objects explore charge - action the_cave - cave)
  (:init (explore_action explore) (charge_action charge))
  (:goal (and (explored the_cave)))
)
#fi
